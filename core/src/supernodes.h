// The structure of a sparse block Cholesky factor: order of the blocks, supernodes, and where the
// update of one supernode goes in the others.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace covinz {

// Rows of blocks that follow one another both in a supernode's update and in the panel that it
// goes to.
struct RowRun {
  int32_t source;  // first row of blocks, counted from the first below the supernode's columns
  int32_t target;  // first row of blocks of the target's panel
  int32_t length;
};

// Columns of a supernode's update that belong to one other supernode.
struct SupernodeUpdate {
  int32_t target;        // supernode
  int32_t source_begin;  // rows [source_begin, source_end) below the columns, and so columns of the
  int32_t source_end;    // update, are columns of the target
  std::vector<RowRun> runs;  // rows from source_begin on
};

// Neighbouring columns of the factor with one structure, kept as a dense panel.
struct Supernode {
  int32_t begin = 0;          // first column
  int32_t end = 0;            // past the last one
  std::vector<int32_t> rows;  // ascending; first the columns themselves
  size_t panel = 0;           // offset of its first double in the factor
  std::vector<SupernodeUpdate> updates;

  size_t NumColumns() const { return static_cast<size_t>(end - begin); }
  size_t NumRows() const { return rows.size(); }
  size_t NumBelow() const { return rows.size() - NumColumns(); }
};

struct Supernodes {
  std::vector<int32_t> position;      // of each row of blocks in the order of elimination
  std::vector<int32_t> supernode_of;  // of each position
  std::vector<Supernode> supernodes;  // by position
  size_t num_doubles = 0;             // of all panels
};

// Doubles from the start of the panel to the block at (row, column), both positions.
size_t BlockOffset(const Supernode& supernode, int32_t row, int32_t column);

// Orders the blocks, finds the supernodes and lays out their panels.
Supernodes AnalyzeStructure(size_t num_blocks,
                            const std::vector<std::pair<int32_t, int32_t>>& pairs);

}  // namespace covinz
