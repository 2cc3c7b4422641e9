"""Poses and keypoints: file formats, virtual cameras and detectors, training batches."""
