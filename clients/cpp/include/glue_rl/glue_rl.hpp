#pragma once

/// RL-Glue for C++: agents, environments and experiments as programs of their own.

#include "abstract_type.hpp"
#include "errors.hpp"
#include "experiment.hpp"
#include "options.hpp"
#include "player.hpp"
#include "roles.hpp"
