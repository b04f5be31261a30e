"""Commands on fleets: thousands of recordings, one table, and what it tells."""
