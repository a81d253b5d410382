"""Published methods: input and output formats of each, one file a method."""
