"""LESS Workbench: what did this person want, and how sure can we be?"""

LESS_WORKBENCH = True
"""Tells this package from others of the name, for `import lessbench`."""
