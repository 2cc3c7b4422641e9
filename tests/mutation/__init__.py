"""Mutation testing: which deliberate faults in posecal's code does no test notice?

A mutant is a module with one small fault: ``<`` for ``<=``, ``+`` for ``-``, 2 for 1, a guard left out. The tests that
belong to the module run against each mutant; one that fails kills it. A mutant that survives marks a line that no
test checks, or a fault that changes nothing. Run from the root of the repository::

    python -m tests.mutation posecal/metrics/position.py posecal/calibration --sample 40 --jobs 2

The tests run in copies of the tree in a temporary folder, so the working tree is never changed. Lines that end in
``# no mutant: REASON`` are left alone; survivors that change nothing are listed, with the reason, in
``tests/mutation/survivors.toml``.
"""
