"""The figures of speed, exactness and limits that `dynaforge bench` measures."""
