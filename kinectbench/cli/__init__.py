"""The command line: parse, call, show. Every algorithm lives in the rooms below."""
