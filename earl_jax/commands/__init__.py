"""The commands of the command line, a function each; its docstring is its help."""
