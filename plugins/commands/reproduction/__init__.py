"""The paper's experiment on the simulated drive, its figures and tables beside the printed numbers."""
