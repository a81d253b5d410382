"""Typed models of all files of `build/`, releases and scores; nothing else reads or writes these files."""
