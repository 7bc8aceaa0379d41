"""LESS Workbench: what did this person want, and how sure can we be?"""
