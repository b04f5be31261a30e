"""What is said and drawn of a diagnosis: reports, words, pictures, and the files that keep them."""
