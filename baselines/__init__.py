"""Whom to compare with: the contenders, and closed-loop scoring that survives an interruption."""
