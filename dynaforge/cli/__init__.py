"""The `dynaforge` command, with one module per subcommand."""
