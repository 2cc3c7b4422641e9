"""What does each command compute, print and draw?

One file for each command of ``python -m toy``: it puts the numbers together, checks one of them by simulation and
gives a :class:`~toy.experiments.result.Result`.
"""
