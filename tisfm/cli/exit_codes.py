"""Exit codes of the command beyond 0, success, and 1, an error that a line explains."""

WRONG_OPTION = 2
INTERRUPTED = 130  # as shells count a program that SIGINT ended
BROKEN_PIPE = 141  # as shells count a program that SIGPIPE ended
