"""Objects and fixtures as URDF; shipped policies. Installs as `dynaforge.assets`."""
