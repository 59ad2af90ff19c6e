"""What is made: one file per kind, holding its recipe section, its frozen model and its build."""
