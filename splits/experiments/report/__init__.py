"""Report of the workflow: one HTML page of figures, comparisons with papers, and tables."""
