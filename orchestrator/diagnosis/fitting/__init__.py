"""The model fitted to the weak form: R_s, the co-energy's coefficients, and the parameters of active effects."""
