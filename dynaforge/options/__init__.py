"""What the options of commands may be: numbers, names, files and folders, each refused in one line.

A type of an option is a callable that argparse calls with the text after the flag. It returns the value, or raises
`Refused` with a message that continues the option's name, as in "--workers is 0; it must be at least 1.". Nothing
heavy is imported here, so that a mistake is reported at once.
"""
