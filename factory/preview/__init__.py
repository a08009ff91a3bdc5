"""A data set as pictures: a contact sheet and a web page."""
