"""The answer of a task: calibration for the user's own set-up, a verdict by stated rules, and the words for it."""
