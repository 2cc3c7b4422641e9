"""posecal_models: reference estimators of 3D pose distributions that plug into posecal."""
