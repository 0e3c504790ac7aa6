"""What the stages measured, for people: tables, figures and a page that shows both."""
