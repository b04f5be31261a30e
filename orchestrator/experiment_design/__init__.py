"""What to measure next: the stage that parts two effects, and how well it would, by the fitted model's prediction."""
