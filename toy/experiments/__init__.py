"""The commands of ``python -m toy``, one module each.

Each ``run`` computes the numbers of a command, checks one of them by simulation and returns a
:class:`~toy.experiments.result.Result`.
"""
