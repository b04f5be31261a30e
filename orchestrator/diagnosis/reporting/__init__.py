"""Results of a diagnosis: reports, words, pictures, and the files that keep them."""
