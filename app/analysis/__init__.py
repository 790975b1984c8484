"""Figures, differences and errors of finished runs."""
