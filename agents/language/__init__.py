"""A language model as an agent: by a server of the Model Context Protocol, or by an endpoint for chats."""
