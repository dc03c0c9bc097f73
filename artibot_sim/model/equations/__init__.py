"""The paper's equations for compiled code."""
