"""A data set as pictures: contact sheet and web page."""
