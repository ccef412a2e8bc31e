"""Writing files so that a kill never leaves an incomplete one, and the versions of the installed packages."""
