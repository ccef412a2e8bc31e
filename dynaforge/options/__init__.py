"""What the options of commands may be: numbers, names, files and folders, each refused in one line."""
