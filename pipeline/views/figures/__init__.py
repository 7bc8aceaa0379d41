"""Figures as SVG and PNG, drawn by matplotlib."""
