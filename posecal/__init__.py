"""posecal: can the uncertainty of a multi-hypothesis 3D human pose model be trusted?"""

__version__ = "0.1.0"
