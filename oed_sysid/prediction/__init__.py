"""What a fitted model says about manoeuvres that nobody measured."""
