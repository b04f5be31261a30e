"""The attacks of the tests, thousands of times: resumable, bounded, from a seed (docs/robustness.md)."""
