"""The kinds of features that a task can name."""
