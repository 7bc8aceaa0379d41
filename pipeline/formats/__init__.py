"""One folder for each outside format; nothing else opens files of that format."""
