"""What is on the sheet of a report, a comparison, a recalibration, or the list of presets?"""

from posecal.report.sheets.comparison import comparison_sheet
from posecal.report.sheets.presets import presets_sheet
from posecal.report.sheets.recalibration import radius_sheet, spread_sheet
from posecal.report.sheets.report import report_sheet

__all__ = ["comparison_sheet", "presets_sheet", "radius_sheet", "report_sheet", "spread_sheet"]
