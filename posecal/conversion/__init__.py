"""Conversion of the files of other tools into the ``.npz`` file that posecal reads."""

from posecal.conversion.convert import FORMATS, convert

__all__ = ["FORMATS", "convert"]
