"""Commands for a controller that keeps the nominal model. Imports result and below."""
