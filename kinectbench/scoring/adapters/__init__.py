"""Published methods: input and output formats, one file per method."""
