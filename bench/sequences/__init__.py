"""Path and depth of whole sequences beside other methods, in chunks, in memory, and in exports."""
