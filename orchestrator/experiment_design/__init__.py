"""Design of experiments: the stage or procedure that separates effects, and how well, by the model's prediction."""
