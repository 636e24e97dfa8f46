"""Many calculations on cores or a cluster, none done twice."""
