"""One file a verb: parse, call one function of the API, print one text."""
