"""Reference estimators, and their construction from a configuration or a weights file."""
