"""Pose data: arrays and files, axes, units, joints, and the matching of hypotheses with the truth."""
