"""What each command takes: one module per command, with its arguments, the check of them together, and its examples.

Everything here is checked before anything heavy is imported and before anything is made. The modules of
`dynaforge.cli` with the same names do the work.
"""
