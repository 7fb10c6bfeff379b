"""Sequences: what a run of the command line costs besides interpreting its pairs."""
