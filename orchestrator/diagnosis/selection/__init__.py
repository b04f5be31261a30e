"""Selection of effects: which ones the data require, and which of them the recording can separate."""
