"""The command line: arguments, configuration, terminal output and the tasks; ``prgbd/__main__.py`` enters here."""
