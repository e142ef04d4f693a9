"""The judge of clicks: what linear programs over many plants reach, slowly, for the closed form to be compared with."""
