"""Whom to compare with: the methods, and closed-loop scoring that survives an interruption."""
