"""What is on the sheet of a report, a comparison, a recalibration, or the list of presets?"""
