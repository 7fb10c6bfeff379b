"""Sequences: paths and depth beside other ways to them, and what the command line costs."""
