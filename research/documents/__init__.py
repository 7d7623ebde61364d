"""Figures of the source documents, drawn anew, with what the documents claim by them measured."""
