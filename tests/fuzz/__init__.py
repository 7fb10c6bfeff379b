"""Readers of files under random and hostile input: ``python -m tests.fuzz --help``."""
