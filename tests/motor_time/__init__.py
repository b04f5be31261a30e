"""How well a map is known after how much motor time: every procedure on three motors of the simulated drive."""
