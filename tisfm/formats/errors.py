"""The one error of files that cannot be read."""


class FormatError(ValueError):
    """A file is damaged, incomplete or not of the format it was read as.

    The text is one line that names the file and what is wrong with it.
    """
