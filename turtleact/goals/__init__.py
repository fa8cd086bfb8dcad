"""Goals: their states, the servers that run them and the clients that send them."""
