"""Pages of the documents whose numbers are measured: templates, measurements and what they gave."""
