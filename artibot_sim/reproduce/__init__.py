"""The paper once more: every figure and table from the model, beside the printed numbers."""
