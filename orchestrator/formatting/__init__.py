"""How anything is shown, once for all: quantities, names, sentences, tables, colours and figures. Computes nothing."""
