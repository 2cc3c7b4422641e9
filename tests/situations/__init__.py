"""Situations from public threads, each with its right values: data, the call, and what posecal must say."""
