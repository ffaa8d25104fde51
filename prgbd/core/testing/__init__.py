"""Checks of plug-ins: passive ones around every plug-in, suites for the tests of their authors, and validation."""
