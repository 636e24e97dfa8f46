"""After data: where a model fails, which effect it lacks, and whether what is left is noise."""
