"""One folder a verb: what it computes, its words, its figures or view, and its command."""
