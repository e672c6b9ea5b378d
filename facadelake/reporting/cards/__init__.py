"""Cards: one sheet per defect."""
