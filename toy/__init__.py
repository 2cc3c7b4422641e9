"""toy: worlds whose answers are known, run as ``python -m toy`` from a checkout."""
