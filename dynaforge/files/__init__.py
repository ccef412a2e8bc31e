"""Writing files so that a kill leaves none in part, and the versions that a result depends on."""
