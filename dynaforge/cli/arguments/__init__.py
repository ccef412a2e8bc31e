"""The arguments of each command: one module per command, with its arguments, the check of them together, and examples.

Everything is checked before anything heavy is imported and before anything is created. The modules of
`dynaforge.cli` with the same names do the work.
"""
