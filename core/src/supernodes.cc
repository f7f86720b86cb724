// Symbolic factorisation, at the level of blocks.
#include "supernodes.h"

#include <algorithm>
#include <numeric>

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>

namespace covinz {
namespace {

using Structure = std::vector<std::vector<int32_t>>;  // rows below the diagonal by column

constexpr int32_t kNone = -1;
constexpr size_t kBlock = 6;

// Position of each block.
std::vector<int32_t> MinimumDegreeOrder(size_t num_blocks,
                                        const std::vector<std::pair<int32_t, int32_t>>& pairs) {
  const auto n = static_cast<Eigen::Index>(num_blocks);
  std::vector<Eigen::Triplet<double, int32_t>> entries;
  entries.reserve(2 * pairs.size() + num_blocks);
  for (int32_t i = 0; i < n; ++i) entries.emplace_back(i, i, 1.0);
  for (const auto& [a, b] : pairs) {
    entries.emplace_back(a, b, 1.0);
    entries.emplace_back(b, a, 1.0);
  }
  Eigen::SparseMatrix<double, Eigen::ColMajor, int32_t> pattern(n, n);
  pattern.setFromTriplets(entries.begin(), entries.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int32_t> order;
  Eigen::AMDOrdering<int32_t>()(pattern.selfadjointView<Eigen::Lower>(), order);
  std::vector<int32_t> position(num_blocks);
  for (int32_t k = 0; k < n; ++k) position[static_cast<size_t>(order.indices()(k))] = k;
  return position;
}

// Rows of each column below the diagonal once blocks are at `position`.
Structure Permuted(const std::vector<std::pair<int32_t, int32_t>>& pairs,
                   const std::vector<int32_t>& position) {
  Structure below(position.size());
  for (const auto& [a, b] : pairs) {
    const auto [first, last] =
        std::minmax(position[static_cast<size_t>(a)], position[static_cast<size_t>(b)]);
    below[static_cast<size_t>(first)].push_back(last);
  }
  return below;
}

// Adds the fill. The parent of a column in the elimination tree is its first row; a column's rows
// are its own and those of its children.
void Fill(Structure* below) {
  const size_t n = below->size();
  Structure children(n);
  std::vector<int32_t> seen(n, kNone);
  for (size_t j = 0; j < n; ++j) {
    std::vector<int32_t>& rows = (*below)[j];
    const auto self = static_cast<int32_t>(j);
    for (const int32_t row : rows) seen[static_cast<size_t>(row)] = self;
    seen[j] = self;
    for (const int32_t child : children[j]) {
      for (const int32_t row : (*below)[static_cast<size_t>(child)]) {
        if (seen[static_cast<size_t>(row)] == self) continue;
        seen[static_cast<size_t>(row)] = self;
        rows.push_back(row);
      }
    }
    std::sort(rows.begin(), rows.end());
    if (!rows.empty()) children[static_cast<size_t>(rows.front())].push_back(self);
  }
}

// Positions by a walk of the elimination tree, children before parents, the child with most rows
// last: its columns then lie next to its parent's.
std::vector<int32_t> Postorder(const Structure& below) {
  const size_t n = below.size();
  Structure children(n + 1);  // of a root: n
  for (size_t j = 0; j < n; ++j) {
    const size_t parent = below[j].empty() ? n : static_cast<size_t>(below[j].front());
    children[parent].push_back(static_cast<int32_t>(j));
  }
  for (std::vector<int32_t>& siblings : children) {
    std::stable_sort(siblings.begin(), siblings.end(), [&](int32_t a, int32_t b) {
      return below[static_cast<size_t>(a)].size() < below[static_cast<size_t>(b)].size();
    });
  }
  // Depth first from the end: parents before children, the last child first.
  std::vector<int32_t> position(n);
  std::vector<int32_t> open = children[n];
  for (size_t next = n; next-- > 0;) {
    const auto node = static_cast<size_t>(open.back());
    open.pop_back();
    position[node] = static_cast<int32_t>(next);
    open.insert(open.end(), children[node].begin(), children[node].end());
  }
  return position;
}

// Time to factorise a panel and to subtract its update, in products of two blocks (measured: a
// block of the update takes about as long to subtract as two products, a panel at least twenty).
double PanelCost(size_t num_columns, size_t num_rows) {
  const auto p = static_cast<double>(num_columns);
  const auto m = static_cast<double>(num_rows);
  const double q = m - p;
  const double products = (m * (m + 1.0) * (m + 2.0) - q * (q + 1.0) * (q + 2.0)) / 6.0;
  return products + q * (q + 1.0) + 20.0;
}

std::vector<Supernode> FundamentalSupernodes(const Structure& below) {
  std::vector<Supernode> supernodes;
  for (size_t j = 0; j < below.size(); ++j) {
    const auto column = static_cast<int32_t>(j);
    const bool continues =
        j > 0 && below[j - 1].size() == below[j].size() + 1 && below[j - 1].front() == column;
    if (continues) {
      supernodes.back().end = column + 1;
      continue;
    }
    Supernode supernode;
    supernode.begin = column;
    supernode.end = column + 1;
    supernode.rows = {column};
    supernode.rows.insert(supernode.rows.end(), below[j].begin(), below[j].end());
    supernodes.push_back(std::move(supernode));
  }
  return supernodes;
}

// Whether `lower`'s parent in the tree begins right after it.
bool IsLastChild(const Supernode& lower, const Supernode& upper) {
  return lower.NumBelow() > 0 && lower.rows[lower.NumColumns()] < upper.end &&
         lower.end == upper.begin;
}

// Merges supernodes with their parents where that is expected to save time.
std::vector<Supernode> Relaxed(const std::vector<Supernode>& fundamental) {
  std::vector<Supernode> merged;
  for (const Supernode& next : fundamental) {
    merged.push_back(next);
    while (merged.size() > 1) {
      Supernode& upper = merged.back();
      const Supernode& lower = merged[merged.size() - 2];
      if (!IsLastChild(lower, upper)) break;
      const double apart = PanelCost(lower.NumColumns(), lower.NumRows()) +
                           PanelCost(upper.NumColumns(), upper.NumRows());
      const size_t num_columns = lower.NumColumns() + upper.NumColumns();
      if (PanelCost(num_columns, num_columns + upper.NumBelow()) > apart) break;
      std::vector<int32_t> rows(lower.NumColumns());
      std::iota(rows.begin(), rows.end(), lower.begin);
      upper.rows.insert(upper.rows.begin(), rows.begin(), rows.end());
      upper.begin = lower.begin;
      merged.erase(merged.end() - 2);
    }
  }
  return merged;
}

SupernodeUpdate UpdateOf(const Supernode& source,
                         size_t source_begin,
                         const Supernode& target,
                         int32_t target_index) {
  const size_t p = source.NumColumns();
  SupernodeUpdate update;
  update.target = target_index;
  update.source_begin = static_cast<int32_t>(source_begin);
  size_t position = 0;
  size_t end = source_begin;
  for (size_t i = source_begin; i < source.NumBelow(); ++i) {
    const int32_t row = source.rows[p + i];
    if (row < target.end) end = i + 1;
    while (target.rows[position] != row) ++position;
    const auto at = static_cast<int32_t>(position);
    if (!update.runs.empty() && update.runs.back().target + update.runs.back().length == at) {
      ++update.runs.back().length;
    } else {
      update.runs.push_back({static_cast<int32_t>(i), at, 1});
    }
  }
  update.source_end = static_cast<int32_t>(end);
  return update;
}

void FindUpdates(Supernodes* structure) {
  for (Supernode& source : structure->supernodes) {
    const size_t p = source.NumColumns();
    for (size_t i = 0; i < source.NumBelow();) {
      const int32_t target = structure->supernode_of[static_cast<size_t>(source.rows[p + i])];
      source.updates.push_back(
          UpdateOf(source, i, structure->supernodes[static_cast<size_t>(target)], target));
      i = static_cast<size_t>(source.updates.back().source_end);
    }
  }
}

}  // namespace

size_t BlockOffset(const Supernode& supernode, int32_t row, int32_t column) {
  const auto at = std::lower_bound(supernode.rows.begin(), supernode.rows.end(), row);
  const auto row_in_panel = static_cast<size_t>(at - supernode.rows.begin());
  const auto column_in_panel = static_cast<size_t>(column - supernode.begin);
  return kBlock * (column_in_panel * kBlock * supernode.NumRows() + row_in_panel);
}

Supernodes AnalyzeStructure(size_t num_blocks,
                            const std::vector<std::pair<int32_t, int32_t>>& pairs) {
  Supernodes structure;
  structure.position = MinimumDegreeOrder(num_blocks, pairs);
  Structure below = Permuted(pairs, structure.position);
  Fill(&below);
  const std::vector<int32_t> postorder = Postorder(below);
  for (int32_t& position : structure.position) position = postorder[static_cast<size_t>(position)];
  below = Permuted(pairs, structure.position);
  Fill(&below);
  structure.supernodes = Relaxed(FundamentalSupernodes(below));
  structure.supernode_of.resize(num_blocks);
  for (size_t s = 0; s < structure.supernodes.size(); ++s) {
    Supernode& supernode = structure.supernodes[s];
    std::fill(structure.supernode_of.begin() + supernode.begin,
              structure.supernode_of.begin() + supernode.end, static_cast<int32_t>(s));
    supernode.panel = structure.num_doubles;
    structure.num_doubles += kBlock * kBlock * supernode.NumColumns() * supernode.NumRows();
  }
  FindUpdates(&structure);
  return structure;
}

}  // namespace covinz
