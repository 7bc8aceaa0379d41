"""Where a project lives: its folder, its parameters, its scenes, the records of its runs, and what computes."""
