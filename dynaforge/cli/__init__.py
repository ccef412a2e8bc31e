"""The `dynaforge` command, one module a subcommand."""
