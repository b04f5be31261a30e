"""The stages that a procedure can name: one module each, with all that is known of it."""
