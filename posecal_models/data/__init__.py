"""Poses and keypoints: where they come from, and how they become what an estimator reads."""
