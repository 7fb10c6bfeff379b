"""Path and depth of whole sequences: compared with other methods, in chunks, and exported."""
