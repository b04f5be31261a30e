"""Commands on fleets: thousands of recordings in one table, and its statistics."""
