# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of several packages share: made-up surfaces, walls and names, and the messages that users can get."""
