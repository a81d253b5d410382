"""Typed models of all files of `build/`, releases and scores; no other code reads or writes these files."""
