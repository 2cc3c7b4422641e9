"""toy: problems with known solutions, run as ``python -m toy`` from a checkout."""
