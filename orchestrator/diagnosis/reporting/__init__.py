"""Results of a diagnosis: report, text, data of figures, and files."""
