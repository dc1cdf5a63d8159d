"""What is read of a recording on its way through a filter, for the doctor and for fleets."""
