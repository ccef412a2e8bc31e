"""Types of command-line options: numbers, names, files and folders; a wrong value is refused in one line.

The type of an option is a callable that argparse calls with the text after the flag. It returns the value, or raises
`Refused` with a message that continues the option's name, as in "--workers is 0; it must be at least 1.". Nothing
heavy is imported here, so that a mistake is reported at once.
"""
