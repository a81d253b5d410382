"""Runs the stages: what is current is skipped, what fails is told, what is killed goes on."""
