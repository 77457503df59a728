"""The command line: options, input, outputs and errors that verbs share."""
