"""Checks of a result by evidence that the result was not made from."""
