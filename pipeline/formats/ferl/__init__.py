"""The pickles that the FERL and jaco_learning repositories published, read as data and written as MCAP."""
