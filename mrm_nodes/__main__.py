"""`python -m mrm_nodes` is the command `mrm-nodes`."""

from mrm_nodes.cli import main

main()
