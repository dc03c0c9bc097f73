"""The paper's sections 5 to 7 once more: every figure and table from the model, beside the printed numbers."""
