"""Alignment of poses."""
