"""Formatting shared by all outputs: quantities, names, sentences, tables, colours and figures."""
