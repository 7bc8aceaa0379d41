"""Motions of an arm in forms that other programs read: MCAP, tables, LeRobot datasets."""
