"""A browser study of choices: what is asked, who is shown what, what is kept, and the server of its page."""
