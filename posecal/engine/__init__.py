"""Blocks of poses, metrics, and sums of per-pose statistics."""
