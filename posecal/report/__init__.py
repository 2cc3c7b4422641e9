"""Reports: numbers, tables, sentences and pages."""
